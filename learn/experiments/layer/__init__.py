"""How accurate and how fast the rendering layer is: its methods and its engine."""

"""Pictures that people look at: montages, spheres of materials, web pages."""

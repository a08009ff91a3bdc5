"""What is written down: the contract on disk between the factory that renders and the networks that learn."""

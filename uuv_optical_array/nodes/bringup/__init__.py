"""What starts the nodes together, and what is said of all of them."""

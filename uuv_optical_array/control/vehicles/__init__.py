"""The demonstration's vehicles and the sea that moves them."""

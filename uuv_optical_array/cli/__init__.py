"""What the commands have in common: options, bags, outputs, progress."""

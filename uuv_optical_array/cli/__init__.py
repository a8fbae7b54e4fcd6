"""What the commands have in common: options, outputs, progress, pages of results."""

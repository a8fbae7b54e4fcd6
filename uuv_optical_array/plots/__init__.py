"""Pictures that several commands and studies draw, and their style."""

"""Which array and lamp to build."""

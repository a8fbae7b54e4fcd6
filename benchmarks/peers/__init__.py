"""Search and simulation measured against other libraries: ``make peers``."""

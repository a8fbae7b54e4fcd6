"""Files: whole or not at all, checked, of YAML, JSON or CSV."""

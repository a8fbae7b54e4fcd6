"""Light that was measured: lamps by their files, a room by its readings."""

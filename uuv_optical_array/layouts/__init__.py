"""Light of detectors in any layout, as tables: readings, places, poses."""

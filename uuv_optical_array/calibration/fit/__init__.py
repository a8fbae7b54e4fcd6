"""The fit of a calibration: what images determine, and what their residuals show."""

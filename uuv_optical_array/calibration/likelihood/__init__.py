"""The likelihood of images by the parameters of a calibration."""

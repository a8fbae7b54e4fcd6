"""From image to pose: features, match, fit, covariance, track."""

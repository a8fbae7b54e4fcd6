"""The Kalman filter that a track is made with: frame, state and correction."""

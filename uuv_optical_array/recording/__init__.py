"""Recorded bags: read, repaired, written and replayed through the estimator, without ROS."""

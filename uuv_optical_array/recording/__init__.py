"""Recorded bags: read, mended, written, and estimated anew; without ROS."""

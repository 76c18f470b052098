"""Trackers: points followed through the frames of one view."""

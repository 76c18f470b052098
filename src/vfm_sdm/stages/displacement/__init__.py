"""Displacement in millimetres from synchronised tracks, and its uncertainty."""

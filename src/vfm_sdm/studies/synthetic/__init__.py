"""Synthetic recordings with exact truth."""

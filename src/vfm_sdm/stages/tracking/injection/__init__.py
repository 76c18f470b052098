"""Gain and noise of tracked points, measured on the recording itself by motion that is put into it."""

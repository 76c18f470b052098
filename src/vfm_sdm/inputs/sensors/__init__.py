"""Recordings of accelerometers and displacement sensors, and reference displacement from them."""

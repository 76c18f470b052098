"""What a measurement reads: the session, videos, sensors."""

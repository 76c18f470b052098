"""What a point's subset compares, chosen before the run from a few frames spread over the recording."""

"""Studies of the method itself: virtual field tests and the paper's protocol."""

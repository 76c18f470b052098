"""A set-up tried on site: what cameras, streams or growing files show of the points, as it comes."""

"""The same place in two views: features, matches, correspondence of named points."""

"""Camera estimators, and the adjustment of their result to what was measured on site."""

"""The five steps of the page, each usable alone: films, points, site, measurement, review."""

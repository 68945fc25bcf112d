"""Borders on the cells of a map: polygons, chains, separating curves, and whether borders split the free floor."""

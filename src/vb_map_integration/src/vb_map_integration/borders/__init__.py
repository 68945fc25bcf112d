"""Borders as messages and as GeoJSON."""

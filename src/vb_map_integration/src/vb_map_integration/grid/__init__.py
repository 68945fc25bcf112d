"""Borders on the cells of a map: sides, regions, the map with borders, and what a border would do to paths."""

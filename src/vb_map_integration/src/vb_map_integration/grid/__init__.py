"""Borders on the cells of a map: sides, regions, the posterior map, and what a border would do to paths."""

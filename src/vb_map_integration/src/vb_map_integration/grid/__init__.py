"""Borders on the cells of a map: sides, regions, the map with borders, and whether borders split the free floor."""

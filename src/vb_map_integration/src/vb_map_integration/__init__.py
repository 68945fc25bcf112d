"""Virtual borders in the occupancy grid: integration, store, map files."""

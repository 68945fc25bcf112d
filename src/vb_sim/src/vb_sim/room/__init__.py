"""The simulated room: world file, floor plan, geometry, appearance and laser spot."""

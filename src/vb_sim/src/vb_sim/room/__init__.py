"""The simulated room: world file, floor plan, geometry, appearance and the laser spot."""

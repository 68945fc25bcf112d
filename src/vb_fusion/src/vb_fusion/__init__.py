"""Makes one polygonal chain and a seed point of the spots that all cameras saw."""

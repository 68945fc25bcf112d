"""Makes a polygonal chain and a seed point from the spots of all cameras."""

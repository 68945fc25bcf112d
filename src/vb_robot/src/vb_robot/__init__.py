"""Makes robots go to the spot, follow it and keep out of borders."""

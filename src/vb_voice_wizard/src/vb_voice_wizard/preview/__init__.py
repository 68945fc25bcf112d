"""Shows what a border would restrict, before it is saved."""

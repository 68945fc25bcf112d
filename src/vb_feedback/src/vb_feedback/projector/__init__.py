"""The projector's image on the floor."""

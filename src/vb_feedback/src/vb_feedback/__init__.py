"""Output for people: RViz markers, LED, sound, a projector's image on the floor."""

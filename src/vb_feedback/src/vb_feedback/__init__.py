"""What people see and hear: RViz markers, LED, sound, a projector's image on the floor."""

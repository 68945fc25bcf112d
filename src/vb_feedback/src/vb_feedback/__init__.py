"""What the person sees and hears: RViz markers, LED, sound."""

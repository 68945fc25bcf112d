"""The dialogue of person and system: what each command does in each state, the border that is drawn, and its preview."""

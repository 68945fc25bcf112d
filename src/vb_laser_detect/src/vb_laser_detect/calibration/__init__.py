"""The lens and pose of a ceiling camera, and whether cameras and clocks agree."""

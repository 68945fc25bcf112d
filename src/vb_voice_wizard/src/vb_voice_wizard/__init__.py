"""Three ways to give commands: voice, the hidden operator's console and buttons."""

"""The interaction's states and commands, and three ways to give commands: voice, wizard console and buttons."""

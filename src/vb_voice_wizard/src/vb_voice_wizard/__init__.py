"""The interaction: states, commands, wizard console, voice, buttons."""

"""The simulated person: perceiving, deciding, walking, drawing."""

"""Settings of all tests: one that draws examples is not told off for a busy computer."""

from hypothesis import settings

settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

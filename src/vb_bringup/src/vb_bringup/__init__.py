"""Tools for a whole lab: creating its folder of settings, checking its launch, checking whether it is ready."""

"""The lab as a whole: a folder with its settings, the checks of its launch, and whether it is ready."""

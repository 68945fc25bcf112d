"""The page for phones, wall displays and the operator of a study."""

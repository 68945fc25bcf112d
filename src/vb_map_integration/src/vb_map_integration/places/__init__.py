"""Which place a map shows, and the transform from an old map to a new one."""

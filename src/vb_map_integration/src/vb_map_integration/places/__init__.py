"""Which place a map shows, and how an old map lies in a new one."""

"""Many bags of many robots: one table of all, and which sensors get worse."""

"""Whether the filter helped on a recording: the verdict, its words, the page and its figures."""

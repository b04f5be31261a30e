"""When no effect of the library explains a recording: the law that is missing, found and written as an effect."""

"""`artibot view`: a rover in three dimensions in the browser, from a recording or live."""

"""Buildings that no rule of the method was made for: the seed draws every measure from ranges of codes and catalogues."""

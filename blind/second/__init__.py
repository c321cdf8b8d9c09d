"""A second generator of blind cases: the milling cell written again from the papers, without a model or the master of the project."""

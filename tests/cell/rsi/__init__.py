"""The link to a robot controller: both sides, on a virtual clock or in lock step."""

"""Where the gap lies: replay attribution, swaps, the place inside a component."""

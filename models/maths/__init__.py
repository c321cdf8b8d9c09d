"""Mathematics that gives the same bits everywhere: elementary functions, frames, filters, noise."""

"""Foreign logs: reading them (`reading`), the mapping file (`mapping`), and what both make (`importing`). See docs/how_to/import.md."""

"""Foreign logs: reading them (`reading`), the mapping file (`mapping`), and what both make (`importing`). See docs/import.md."""

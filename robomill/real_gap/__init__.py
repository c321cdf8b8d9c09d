"""The recorded KR 300 against its rigid-body model: what is wrong with the model, and how far that closes the gap (docs/real_gap.md)."""

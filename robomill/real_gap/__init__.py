"""The recorded KR 300 against its rigid-body model: what is wrong, how far that closes the gap (docs/recordings/real_gap.md)."""

"""Runs on disk and in memory: written step by step, read, resumed, watched over."""

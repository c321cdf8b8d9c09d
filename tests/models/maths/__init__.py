"""Tests of elementary functions, frames, filters, random numbers."""

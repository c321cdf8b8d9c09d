"""Tests of the forms of unknown laws, and of onsets."""

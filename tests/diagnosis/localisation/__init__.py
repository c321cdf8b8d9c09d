"""Tests of where a difference arises."""

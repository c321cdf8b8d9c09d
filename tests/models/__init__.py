"""Tests of the models and of what they are made of."""

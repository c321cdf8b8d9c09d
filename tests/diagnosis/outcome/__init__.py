"""Tests of the answer: verdict, closure, the next run, what is adopted."""

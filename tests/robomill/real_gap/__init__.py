"""Tests of the study of the recorded KR 300."""

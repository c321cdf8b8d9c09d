"""The blind benchmark: cases whose effects are withheld, sealed truth, a scorer and baselines. Never imported by `diagnosis`, and never imports it."""

"""The blind benchmark: cases whose effects are withheld, sealed truth, a scorer, baselines. Apart from `diagnosis`, both ways."""

"""Signs that a data set is read wrongly: measured on every frame, judged over all of them."""

"""Single detections brought to measured depth."""

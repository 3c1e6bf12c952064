"""What is known of cameras and objects over time, in the world of the headset's tracking."""

"""Cameras and objects adjusted together on what the pictures show: contours, depth, keypoints, estimated poses."""

"""Views with object estimates in, camera and object poses with covariances out."""

from multicam.registration.agreement import LearningConfig, learn_noise
from multicam.registration.config import RegistrationConfig
from multicam.registration.register import register_views

__all__ = ["LearningConfig", "RegistrationConfig", "learn_noise", "register_views"]

"""Views with object estimates in, camera and object poses with covariances out."""

from multicam.registration.config import RegistrationConfig
from multicam.registration.register import register_views

__all__ = ["RegistrationConfig", "register_views"]

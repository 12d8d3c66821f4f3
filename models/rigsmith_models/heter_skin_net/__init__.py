from .network import HeterSkinNet

__all__ = ["HeterSkinNet"]

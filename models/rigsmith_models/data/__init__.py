from .character import Character, read_cache, write_cache

__all__ = ["Character", "read_cache", "write_cache"]

"""Any depth model of the Transformers library."""

from prgbd.plugins.depth.huggingface.network import HuggingFaceDepth

__all__ = ["HuggingFaceDepth"]

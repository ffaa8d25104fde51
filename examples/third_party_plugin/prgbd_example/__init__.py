"""An example of plug-ins for prgbd. Nothing is imported here, so finding the plug-ins costs nothing."""

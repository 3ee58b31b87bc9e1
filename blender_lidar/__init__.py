"""Where should a LiDAR hang beside the road, how high and how tilted, so that it perceives the most vehicles?"""

__version__ = "0.1.0"

"""ROS 2 messages: types made from `msgs/`, wire format, conversions."""

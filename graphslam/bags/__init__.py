"""Logs from bags of ROS 1 (.bag), ROS 2 (.db3, .mcap, or their folder), read by the pure-Python package ``rosbags``.

bag         an open bag: topics, messages in the order of their recording, errors of files
paths       fields of a message type by its definition, and their values
frames      rigid motions between the frames of /tf and /tf_static
candidates  what each topic could be, and which would be chosen
extract     the messages of a topic as a table
read        the streams of a drive
"""

import csv, json, sys
from mcap.reader import make_reader
rows = list(csv.DictReader(open(sys.argv[1] + '.csv')))
topics = {}
with open(sys.argv[1] + '.mcap', 'rb') as file:
    for _, channel, message in make_reader(file).iter_messages():
        topics.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
seen = set()
for messages in topics.values():
    assert len(messages) == len(rows), len(messages)
    for row, (time, values) in zip(rows, messages):
        assert time == round(float(row['t_s']) * 1e9)
        for name, value in values.items():
            assert value == float(row[name]), (name, value, row[name])
            seen.add(name)
assert seen | {'t_s'} == set(rows[0]), set(rows[0]) - seen
print(len(rows), len(topics))

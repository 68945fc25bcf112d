import threading

from vb_core.ros.node import Mailbox


def test_the_newest_item_wins_and_the_others_are_counted():
    mailbox = Mailbox()
    for number in range(5):
        mailbox.put(number)
    assert mailbox.take() == 4
    assert (mailbox.received, mailbox.dropped) == (5, 4)


def test_closing_wakes_the_one_who_waits():
    mailbox = Mailbox()
    taken = []
    thread = threading.Thread(target=lambda: taken.append(mailbox.take()))
    thread.start()
    mailbox.close()
    thread.join(10)
    assert taken == [None] and not thread.is_alive()

"""What exists once in a process."""

import threading

from turtleact.rclpy.impl.process import Process


def test_the_end_of_the_process_waits_for_contexts_that_other_threads_shut_down():
    process = Process()
    began, goes_on = threading.Event(), threading.Event()

    def end():
        with process.ending:
            began.set()
            goes_on.wait()

    ending = threading.Thread(target=end)
    ending.start()
    began.wait()
    leaving = threading.Thread(target=process.shut_down)
    leaving.start()
    leaving.join(0.05)
    assert leaving.is_alive()
    goes_on.set()
    ending.join()
    leaving.join()


def test_a_context_that_ends_does_not_wait_for_itself():
    process = Process()
    with process.ending:
        process.shut_down()

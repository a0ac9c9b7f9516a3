"""The processes beside a program: servo, recorder, tracker; and the real-time loop."""

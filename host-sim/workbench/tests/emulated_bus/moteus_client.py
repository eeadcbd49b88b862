import asyncio, sys, moteus
async def main():
    transport = moteus.Fdcanusb(sys.argv[1], command_timeout=10, response_timeout=10)
    drive = moteus.Controller(id=1, transport=transport)
    for _ in range(20):
        reply = await asyncio.wait_for(
            drive.set_position(position=0.5, velocity=0.0, feedforward_torque=0.25, query=True), 10)
        values = reply.values
        print(values[moteus.Register.MODE], values[moteus.Register.POSITION], values[moteus.Register.TORQUE], flush=True)
asyncio.run(main())

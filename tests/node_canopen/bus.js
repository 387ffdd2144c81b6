'use strict';
/** Two ways to the bus: socketcand over TCP, and a SocketCAN socket that the parent process opened. */

const fs = require('fs');
const net = require('net');

const hex = (number, width) => number.toString(16).toUpperCase().padStart(width, '0');

/** A socketcand server in raw mode for one channel; clients hear the drives and each other. */
class SocketcandServer {
    constructor(channel, receive) {
        this.channel = channel;
        this.receive = receive;
        this.clients = new Set();
        this.server = net.createServer((socket) => this._greet(socket));
    }

    /** Resolves to the port. */
    listen() {
        return new Promise((resolve, reject) => {
            this.server.once('error', reject);
            this.server.listen(0, '127.0.0.1', () => resolve(this.server.address().port));
        });
    }

    send(id, data, but = null) {
        const line = `< frame ${hex(id, 3)} ${(Date.now() / 1e3).toFixed(6)} ${data.toString('hex').toUpperCase()} >`;
        for (const client of this.clients)
            if (client !== but)
                client.write(line);
    }

    _greet(socket) {
        let rest = '';
        socket.setNoDelay(true);
        socket.on('error', () => socket.destroy());
        socket.on('close', () => this.clients.delete(socket));
        socket.on('data', (bytes) => {
            const lines = (rest + bytes.toString('latin1')).split('>');
            rest = lines.pop();
            for (const line of lines)
                this._command(socket, line.replace('<', '').trim().split(/\s+/));
        });
        socket.write('< hi >');
    }

    _command(socket, [order, ...words]) {
        if (order === 'open' && words[0] === this.channel)
            socket.write('< ok >');
        else if (order === 'rawmode') {
            socket.write('< ok >');
            this.clients.add(socket); // what is sent from now on may share a packet with this answer
        }
        else if (order === 'echo')
            socket.write('< echo >');
        else if (order === 'send' && this.clients.has(socket)) {
            const [id, , ...data] = words.map((word) => parseInt(word, 16));
            this.send(id, Buffer.from(data), socket);
            this.receive(id, Buffer.from(data));
        }
        else
            socket.write('< error unknown command >');
    }
}

/** Frames as the kernel has them (struct can_frame, 16 bytes), on file descriptor `fd`. */
class KernelBus {
    constructor(fd, receive) {
        this.fd = fd;
        this.receive = receive;
    }

    /** Resolves once frames are read; there is no port. */
    async listen() {
        this._read();
        return null;
    }

    send(id, data) {
        const frame = Buffer.alloc(16);
        frame.writeUInt32LE(id, 0);
        frame.writeUInt8(data.length, 4);
        data.copy(frame, 8);
        try {
            fs.writeSync(this.fd, frame);
        }
        catch (error) {
            if (!['EAGAIN', 'ENOBUFS', 'ENETDOWN'].includes(error.code))
                throw error; // a bus that takes nothing loses the frame
        }
    }

    _read() {
        const frame = Buffer.alloc(16);
        fs.read(this.fd, frame, 0, 16, null, (error, count) => {
            if (!error && count === 16 && !(frame.readUInt32LE(0) & 0xE0000000))
                this.receive(frame.readUInt32LE(0), frame.subarray(8, 8 + frame.readUInt8(4)));
            if (!error || ['EAGAIN', 'EINTR', 'ENETDOWN'].includes(error.code))
                this._read(); // EAGAIN: the time-out of the socket; EINTR: the process was suspended
            else
                throw error;
        });
    }
}

module.exports = { KernelBus, SocketcandServer };

/* An ECU as a process: fluxbench's routine before a motor in software, and XCP on Ethernet, at the loopback address alone.

       ecu udp|tcp PORT LAMP

   LAMP is a file whose first octet is 1 while the gates are on. SIGUSR1 loses one row, SIGUSR2 one answer. */

#define _GNU_SOURCE
#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "fluxbench_config.h"
#include "fluxbench_xcp.h"
#include "motor.h"
#include "xcp.h"

#define FORGIVEN_S 0.25  /* a host that was busy hands the time over late */
#define ATTENDED_S 0.002 /* longest without a look at the network */
#define HEAD 4u          /* octets before a message on Ethernet: its length and its number */
#define DATAGRAM 1400u
#define SQRT3 1.73205081f

static struct {
    bool is_tcp;
    int listening, line;
    struct sockaddr_in master;
    uint16_t number;
    uint8_t out[DATAGRAM + HEAD + XCP_MOST_DTO];
    size_t waiting;
    uint8_t in[65536];
    size_t came;
} net = {.listening = -1, .line = -1};
static struct motor motor;
static volatile sig_atomic_t is_ending, loses, is_mute;
static int lamp;

static double now_s(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void on_signal(int number)
{
    if (number == SIGUSR1) {
        loses = 1;
    } else if (number == SIGUSR2) {
        is_mute = 1;
    } else {
        is_ending = 1;
    }
}

/* Network */

static void hang_up(void)
{
    if (net.is_tcp && net.line >= 0) {
        (void)close(net.line);
        net.line = -1;
    }
    net.waiting = net.came = 0u;
    xcp_forget();
}

/* As much as the network takes now: an ECU waits for nobody. */
static void flush(void)
{
    const ssize_t sent =
        net.is_tcp ? send(net.line, net.out, net.waiting, MSG_NOSIGNAL | MSG_DONTWAIT)
                   : sendto(net.line, net.out, net.waiting, 0, (struct sockaddr *)&net.master, sizeof(net.master));

    if (sent > 0) {
        net.waiting -= (size_t)sent;
        memmove(net.out, net.out + sent, net.waiting);
    } else if (!net.is_tcp) {
        net.waiting = 0u; /* nobody is there: a network loses it */
    }
}

static void say(const uint8_t *message, size_t octets, size_t most)
{
    uint8_t *to = net.out + net.waiting;

    if (octets == 0u || net.waiting + HEAD + octets > most) {
        return; /* what a slow master does not take is lost */
    }
    to[0] = (uint8_t)octets;
    to[1] = (uint8_t)(octets >> 8);
    to[2] = (uint8_t)net.number;
    to[3] = (uint8_t)(net.number >> 8);
    memcpy(to + HEAD, message, octets);
    net.number++;
    net.waiting += HEAD + octets;
    if (net.waiting >= DATAGRAM - XCP_MOST_DTO) {
        flush();
    }
}

/* Whole commands; what is left waits for its rest. */
static void answer_all(void)
{
    size_t at = 0u;

    while (net.came - at >= HEAD) {
        const size_t octets = (size_t)net.in[at] + 256u * (size_t)net.in[at + 1];
        uint8_t answer[XCP_MOST_CTO + 1u];

        if (net.came - at < HEAD + octets) {
            break;
        }
        if (octets > 0u) {
            const size_t size = xcp_answer(net.in + at + HEAD, octets, answer);

            say(answer, is_mute == 0 ? size : 0u, sizeof(net.out));
            flush();
            is_mute = 0;
        }
        at += HEAD + octets;
    }
    if (at <= net.came) {
        memmove(net.in, net.in + at, net.came - at);
        net.came -= at;
    }
}

static void accept_master(void)
{
    const int one = 1;
    const int line = accept(net.listening, NULL, NULL);

    if (line >= 0) {
        hang_up();
        net.line = line;
        (void)setsockopt(line, IPPROTO_TCP, TCP_NODELAY, &one, sizeof(one));
    }
}

static void hear(void)
{
    socklen_t size = sizeof(net.master);
    const ssize_t count = net.is_tcp ? recv(net.line, net.in + net.came, sizeof(net.in) - net.came, MSG_DONTWAIT)
                                     : recvfrom(net.line, net.in, sizeof(net.in), MSG_DONTWAIT,
                                                (struct sockaddr *)&net.master, &size);

    if (count > 0) {
        net.came = (net.is_tcp ? net.came : 0u) + (size_t)count;
        answer_all();
    } else if (count == 0 && net.is_tcp) {
        hang_up();
    }
}

static void attend(int timeout_ms)
{
    struct pollfd ends[] = {{.fd = net.line, .events = POLLIN}, {.fd = net.listening, .events = POLLIN}};

    if (net.waiting > 0u) {
        flush();
    }
    if (poll(ends, 2u, timeout_ms) > 0) {
        if ((ends[1].revents & POLLIN) != 0) {
            accept_master();
        } else if (ends[0].revents != 0) {
            hear();
        }
    }
}

static bool open_network(const char *protocol, const char *port)
{
    const int one = 1;
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(port))};
    int made;

    here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    net.is_tcp = strcmp(protocol, "tcp") == 0;
    made = socket(AF_INET, net.is_tcp ? SOCK_STREAM : SOCK_DGRAM, 0);
    (void)setsockopt(made, SOL_SOCKET, SO_REUSEADDR, &one, sizeof(one));
    if (bind(made, (struct sockaddr *)&here, sizeof(here)) != 0 || (net.is_tcp && listen(made, 1) != 0)) {
        return false;
    }
    *(net.is_tcp ? &net.listening : &net.line) = made;
    return true;
}

/* The fast routine */

static void show(bool gates)
{
    const char shown = gates ? '1' : '0';

    if (gates != motor.gates) {
        motor.gates = gates;
        (void)!pwrite(lamp, &shown, 1u, 0);
    }
}

static void sample(void)
{
    struct fluxbench_vector i, v;
    uint8_t message[XCP_MOST_DTO];
    float b;

    motor_read(&motor, &i.x, &b);
    i.y = (i.x + 2.0f * b) / SQRT3;
    show(fluxbench_step(i.x, i.y, MOTOR_BUS_V, &v));
    motor_set_duties(&motor, 0.5f + v.x / MOTOR_BUS_V, 0.5f + (-0.5f * v.x + 0.5f * SQRT3 * v.y) / MOTOR_BUS_V,
                     0.5f + (-0.5f * v.x - 0.5f * SQRT3 * v.y) / MOTOR_BUS_V);
    if (loses != 0) {
        loses = 0;
    } else {
        say(message, xcp_event(message), DATAGRAM); /* the rest is for answers */
    }
    motor_pass(&motor, 1.0f / FLUXBENCH_SAMPLING_HZ);
}

int main(int argc, char **argv)
{
    const struct sched_param first = {.sched_priority = 1};
    double due_s = now_s();

    if (argc != 4 || !open_network(argv[1], argv[2]) || (lamp = open(argv[3], O_RDWR | O_CREAT | O_TRUNC, 0600)) < 0) {
        (void)fprintf(stderr, "usage: ecu udp|tcp PORT LAMP\n");
        return 2;
    }
    (void)!pwrite(lamp, "0", 1u, 0);
    (void)signal(SIGTERM, on_signal);
    (void)signal(SIGUSR1, on_signal);
    (void)signal(SIGUSR2, on_signal);
    (void)sched_setscheduler(0, SCHED_RR, &first); /* an ECU shares its time with nobody; not every system allows it */
    motor_init(&motor);
    while (is_ending == 0) {
        const double begun_s = now_s();

        if (begun_s - due_s > FORGIVEN_S) {
            due_s = begun_s - FORGIVEN_S;
        }
        while (due_s <= begun_s && now_s() - begun_s < ATTENDED_S) {
            sample();
            due_s += 1.0 / (double)FLUXBENCH_SAMPLING_HZ;
        }
        attend(due_s > now_s() ? 1 : 0);
    }
    return 0;
}
